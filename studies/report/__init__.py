"""All that the studies found on one page, a single file: ``python -m studies.report``."""

from .page import write

__all__ = ["write"]
