"""What people do to models: compare two versions, and draw.

::

    changes     two versions of a file, compared: in words, as JSON, as a picture
    session     the source of the page that draws; modeler: the library that it draws with
    writer      what an editor has changed, written into the text of the file
"""
