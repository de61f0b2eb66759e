"""Names of reference drivers and case studies for comparisons."""

REFERENCE_DRIVERS = ("random", "blind", "rule-based")
"""Drivers that do not learn; the last is the one that a policy has to beat."""

CASE_STUDIES = {
    "roundabout": "athrl/Roundabout-v0",
    "oncoming-traffic": "athrl/OncomingTraffic-v0",
    "unprotected-left": "athrl/UnprotectedLeft-v0",
}
"""The paper's case studies: short name -> id of the environment."""
