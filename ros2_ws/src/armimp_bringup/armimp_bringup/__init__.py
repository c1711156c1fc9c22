"""Orchestrator of the node graph, study runner and the armimp command line."""
