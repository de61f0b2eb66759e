"""Episodes as MCAP files, and as rerun files made from these."""
