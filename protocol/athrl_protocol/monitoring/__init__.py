"""Metrics for Prometheus: what each is called and means, and the endpoint at which a service shows its own.

`table` is the one list of all metrics: the endpoint's names and help texts, and the reference page, follow
from it. `figures` and `fleet` keep what is shown; `endpoint` answers scrapes.
"""
