"""What people do to models: compare two versions, draw, and run what they draw.

::

    changes     two versions of a file, compared: in words, as JSON, as a picture; commits: the one of the last commit
    session     the source of the page that draws; modeler: the library that it draws with
    running     the run beside the diagram, which changes with the model
    writer      what an editor has changed, written into the text of the file
"""
