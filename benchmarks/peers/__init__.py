"""The plant, its linear models and its designs beside independent engines; ``python -m benchmarks.peers``."""
