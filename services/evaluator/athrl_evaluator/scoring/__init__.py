"""Episodes on fixed seeds and the scores that follow from them."""
