"""Tools for compiled kernels: compilation, references to state, views of state, random numbers."""
