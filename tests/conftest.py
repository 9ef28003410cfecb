"""What all tests share: property tests take the same examples every time, and no clock stops them."""

from hypothesis import settings

settings.register_profile("dpend", deadline=None, max_examples=30, derandomize=True)
settings.load_profile("dpend")
