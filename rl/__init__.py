"""Learners for the inverted double pendulum on a cart."""
