"""What people do to models: compare two versions, and draw.

::

    changes     two versions of a file, compared: in words, as JSON, as a picture
"""
