"""The log of experience: every accepted chunk, as it arrived, before it is acknowledged.

    experience/segment-00000012.log     header, then one record after another

The replay is restored from the log: a checkpoint only names the segments that it needs, and after a crash the
records after the newest checkpoint are restored as well.
"""

from athrl_learner.log.reading import Damage, SegmentReader
from athrl_learner.log.records import Kind, Record
from athrl_learner.log.retention import needed_segments
from athrl_learner.log.segments import (
    LogPosition,
    SegmentFacts,
    count_of,
    numbered_segments,
    segment_name,
)
from athrl_learner.log.syncing import IntervalSync
from athrl_learner.log.writing import SegmentLog

__all__ = [
    "Damage",
    "IntervalSync",
    "Kind",
    "LogPosition",
    "Record",
    "SegmentFacts",
    "SegmentLog",
    "SegmentReader",
    "count_of",
    "needed_segments",
    "numbered_segments",
    "segment_name",
]
