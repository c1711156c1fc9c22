"""Helpers that tests of all packages share: graphs, recordings, runs, known arms."""
