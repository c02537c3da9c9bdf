"""Learned models on the data of robots: processors, the nodes that run them, what they learn from and what they record.

::

    processor    Processor, Parameter, Samples: the interface of everything that computes
    processors   those that come with FAME, by name
    filters      low-pass, resample, scale
    windows      windows of samples, and what is told of each: RMS, spectrum, moving statistics
    learned      any estimator of scikit-learn; autoencoders
    decisions    threshold with hysteresis; expressions
    machine      what polls machines outside ROS
    stacking     several inputs as one
    offline      recorded arrays through a pipeline, without nodes
    network      the layers of a perceptron, evaluated for all channels at once
    model        TrainedModel: autoencoders with thresholds, stored and loaded
    onnx         the same as ONNX files
    tables       recorded CSV files as runs
    train        `fame train`

    configuration  the file of a node
    fields         paths into messages: reading numbers
    writing        messages put together from numbers
    loading        processors made from a configuration
    intake         subscriptions, and what can be used of what arrives
    outlet         publishers
    parameters     those of nodes, as parameters of ROS 2
    node           the processing node
    recording      the recording node; into `rows` (CSV), `bagging` (bags), `influx` (a database)
    units          all of them as parts of a mission
    looking        `fame topic`
    plots, graph   pictures of losses, and of pipelines

A processor is called at a fixed frequency with the samples that arrived since the last call. What it computes does not
depend on how samples are cut into calls, so a recording put through at once gives what the nodes gave live.
"""
