"""Learners as users write them, each in one file to be read from top to bottom."""
