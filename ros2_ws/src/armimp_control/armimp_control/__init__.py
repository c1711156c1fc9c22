"""IMBIC controller: laws, perturbation, trial sequencer, safety limiter, and the node with them."""
