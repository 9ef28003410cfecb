"""What all tests share: property tests take the same examples every time, and no clock stops them."""

import numpy as np
import pytest
from hypothesis import settings

settings.register_profile("dpend", deadline=None, max_examples=30, derandomize=True)
settings.load_profile("dpend")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let what is nightly be slow too: ``-m "not slow"`` takes the place of the default, which leaves it out."""
    for item in items:
        if item.get_closest_marker("nightly"):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(autouse=True)
def same_numbers(request: pytest.FixtureRequest) -> None:
    """Have a test draw the same numbers whichever tests ran before it: a module's ``RNG`` begins anew."""
    if isinstance(rng := getattr(request.module, "RNG", None), np.random.Generator):
        rng.bit_generator.state = np.random.default_rng(0).bit_generator.state
