"""Wrappers and adapters, one per file."""

from bicycle_env.wrappers.front_driver import FrontDriver
from bicycle_env.wrappers.record_success import RecordSuccess

__all__ = ["FrontDriver", "RecordSuccess"]
