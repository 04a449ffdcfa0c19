"""The recoverable set: from which states can the car be saved at all?"""

from bicycle_env.analysis.recovery.least_time import IntractableError
from bicycle_env.analysis.recovery.recoverable_set import RecoverableSet
from bicycle_env.analysis.recovery.search import recoverable_set

__all__ = ["IntractableError", "RecoverableSet", "recoverable_set"]
