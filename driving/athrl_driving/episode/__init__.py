"""One decision of an episode as one compiled call: state, kernel, and the Python that begins episodes."""
