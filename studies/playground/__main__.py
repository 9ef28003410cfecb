"""Serve the page of double pendulums, or write it: ``python -m studies.playground``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .export import export


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve the page until interrupted, or write it into a folder."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.playground", description="Serve a page of double pendulums that one can touch."
    )
    parser.add_argument("--export", type=Path, metavar="FOLDER", help="write the page that needs no server, and end")
    parser.add_argument("--controller", action="append", default=[], help="your own: path.py:factory or module:factory")
    parser.add_argument("--no-browser", action="store_true", help="print the address, and open no browser")
    parser.add_argument("--port", type=int, default=0, help="left out, a free one")
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="where to listen; beyond this machine, the address that is printed has a token",
    )
    options = parser.parse_args(arguments)
    try:
        if options.export is not None:
            print(export(options.export))
            return
        try:
            from .server import Server
        except ImportError as error:
            raise ValueError(
                f"The server needs {error.name}: pip install -e '.[web]'. The page without a server: --export FOLDER."
            ) from error
        server = Server(options.controller, options.host, options.port)
    except (OSError, ValueError, OverflowError) as error:
        parser.exit(2, f"{error}\n")
    server.run(not options.no_browser)


if __name__ == "__main__":
    main()
