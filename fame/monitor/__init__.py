"""Data-driven monitoring: processing nodes, recorders, learned models, and the anomaly detection module."""
