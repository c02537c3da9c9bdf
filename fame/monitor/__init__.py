"""Data-driven monitoring: pipelines of processors, recording, learned models, and anomaly detection for arms.

pipeline    processors, the nodes that run them, recording, training
anomaly     learn what a repetitive task of an arm looks like; raise an alarm when a run differs
services    the services of both, for service tasks of a mission
data_files  CSV tables and bags; `storage`: models on disk
plots       plots of all of it
kinematics  forward kinematics of serial arms
arrays      types of arrays
"""
