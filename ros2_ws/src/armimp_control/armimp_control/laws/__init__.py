"""Control laws, compiled, behind one interface."""
