"""IMBIC controller: law, perturbation, trial sequence, safety gate, and the node that runs them."""
