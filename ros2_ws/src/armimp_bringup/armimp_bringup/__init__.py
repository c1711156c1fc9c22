"""Orchestrator of the node graph, study runner and the armimp command line."""

import os

# Matrices are small here, so threads of the linear algebra would only wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
