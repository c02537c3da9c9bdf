"""Commands of learned models, and of the topics and parameters of nodes."""
