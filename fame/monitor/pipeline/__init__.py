"""Pipelines: processors, the nodes that run them, learned models, and recording.

Processors::

    processor      Processor, Parameter, Samples: the interface of everything that computes
    processors     the built-in ones by name; making those of a configuration
    filters        low-pass, resample, scale
    windows        windows of samples, and their RMS, spectrum, moving statistics
    estimators     any estimator of scikit-learn or ONNX; autoencoders
    threshold      threshold with hysteresis; expressions
    polled_source  machines outside ROS, polled
    offline        recorded arrays through a pipeline, without nodes

Models::

    trained_model  TrainedModel: autoencoders with thresholds, stored and loaded
    onnx           the same as ONNX files
    train          `fame train`

Nodes::

    configuration  the file of a node
    fields         paths into messages, and reading numbers
    writing        messages put together from numbers
    subscriptions  subscriptions, and the samples that arrive
    node           the processing node and its publications
    parameters     parameters of nodes, as those of ROS 2
    recording      the recording node; into `rows` (CSV), bags, or `influx` (a database)
    topic_tools    `fame topic`
    graph          a drawing of pipelines

A processor is called at a fixed frequency with the samples that arrived since the last call. What it computes does not
depend on how samples are cut into calls, so a recording processed at once gives what the nodes gave live.
"""
