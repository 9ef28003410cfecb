"""A page to touch: double pendulums that one pushes, changes and compares while they run.

``python -m studies.playground`` serves it, with every controller at work in Python; ``--export FOLDER`` writes it as
one file that needs no server, with the plant and all laws that are formulas in JavaScript.
"""
