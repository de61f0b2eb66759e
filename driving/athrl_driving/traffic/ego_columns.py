"""The ego's state as numbers: what each column of `ego` holds."""

X, Y, HEADING, SPEED, LENGTH, WIDTH, ELEVATION, PRESENT, EGO_SIZE = range(9)
"""Places in `ego`, float64 [8]: m, m, rad, m/s, m, m, m, and 1.0 where there is an ego."""
