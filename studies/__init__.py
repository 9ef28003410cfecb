"""Questions about controllers and learners, one file each; ``python -m studies`` lists them."""

import sys
from importlib.util import find_spec
from pathlib import Path

for _package in ("dpend", "controllers", "rl"):
    _found = find_spec(_package)
    if _found is not None and Path(_found.origin or "").parent.parent != Path(__file__).parent.parent:
        _message = (
            f"Here Python finds another package called {_package!r}, {_found.origin or 'a folder'}, before the one "
            "that the studies need: change to another folder, or rename that package."
        )
        if sys.argv[0] == "-m":  # python -m: a sentence does, without a trace
            raise SystemExit(_message)
        raise ImportError(_message)
