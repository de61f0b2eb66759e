"""`athrl submit`: a run as jobs of a cluster's scheduler."""
