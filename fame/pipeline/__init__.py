"""Learned models on the data of robots: processors, the nodes that run them, what they learn from and what they record.

::

    processor    Processor, Parameter, Samples: the interface of everything that computes
    processors   those that come with FAME, by name
    filters      low-pass, resample, scale
    windows      windows of samples, and what is told of each: RMS, spectrum, moving statistics
    learned      any estimator of scikit-learn; autoencoders
    decisions    threshold with hysteresis; expressions
    offline      recorded arrays through a pipeline, without nodes
    network      the layers of a perceptron, evaluated for all channels at once
    model        TrainedModel: autoencoders with thresholds, stored and loaded
    train        `fame train`

A processor is called at a fixed frequency with the samples that arrived since the last call. What it computes does not
depend on how samples are cut into calls, so a recording put through at once gives what the nodes gave live.
"""
