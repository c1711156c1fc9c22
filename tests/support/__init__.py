"""What the tests of all packages share: graphs, recordings, runs, known arms."""
