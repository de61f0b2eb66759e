"""The log of experience: every accepted chunk, as it came, before it is acknowledged.

    experience/segment-00000012.log     header, then one record after another

The log is what the replay is made of: a checkpoint only names the segments that it needs, and after a crash
the records behind the newest checkpoint are taken in once more.
"""

from athrl_learner.segments.facts import LogPosition, SegmentFacts, numbered_segments, segment_name
from athrl_learner.segments.reading import Damage, SegmentReader
from athrl_learner.segments.records import Kind, Record
from athrl_learner.segments.retention import needed_segments
from athrl_learner.segments.syncing import IntervalSync
from athrl_learner.segments.writing import SegmentLog

__all__ = [
    "Damage",
    "IntervalSync",
    "Kind",
    "LogPosition",
    "Record",
    "SegmentFacts",
    "SegmentLog",
    "SegmentReader",
    "needed_segments",
    "numbered_segments",
    "segment_name",
]
