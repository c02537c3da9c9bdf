"""Pipelines: processors, the nodes that run them, learned models, and recording.

Processors::

    processor      Processor, Parameter, Samples: the interface of everything that computes
    processors     the built-in ones by name; those of a configuration made, and applied to recorded data
    filters        low-pass, resample, scale; windows, and their RMS, spectrum, moving statistics
    estimators     any estimator of scikit-learn or ONNX; autoencoders
    threshold      threshold with hysteresis; expressions
    polled_source  machines outside ROS, polled

Models::

    trained_model  TrainedModel: a detector with thresholds, stored and loaded; onnx_files: also as ONNX
    detectors      kinds of detectors: autoencoders, PCA, nearest neighbours ...; phases: the one that knows time;
                   other_estimators: those of scikit-learn and PyOD
    elements       the time axis of elements of a mission; band: what the training runs did over it
    run_finder     which windows are of a run: by a run_trigger, or cycles in the data
    train          `fame monitor train`; training_settings: its settings; training_checks: its warnings; compare: its
                   option `--compare`

Nodes::

    configuration  the file of a node
    fields         paths into messages: numbers read, and messages made of numbers
    input_node     what all nodes have: subscriptions, samples, silent topics
    node           the processing node and its publications
    parameters     parameters of nodes, as those of ROS 2
    recording      the recording node; `sinks`: CSV files, bags, InfluxDB
    topic_tools    `fame topic`

A processor is called at a fixed frequency with the samples that arrived since the last call. What it computes does not
depend on how samples are cut into calls, so a recording processed at once gives what the nodes gave live.
"""
