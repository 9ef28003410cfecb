"""Write a control law in another language: ``python -m studies.export CONTROLLER --to c``."""

from __future__ import annotations

import argparse
from pathlib import Path

import dpend
from controllers import Differences, WithEstimator
from dpend.emit import REALS

from . import FORMS, controller_named, export

parser = argparse.ArgumentParser(
    prog="python -m studies.export", description="Write a control law in another language."
)
parser.add_argument("controller", help="TVLQR or another contender, ppo-swing-up or another policy, or path.py:factory")
parser.add_argument("--to", choices=FORMS, required=True, help="the language; onnx for networks")
parser.add_argument("--rig", default="gustafsson2016", help="what it is for: a preset, or a file.toml")
parser.add_argument("--real", choices=REALS, default="double", help="the type of numbers in C and ONNX")
parser.add_argument("--differences", action="store_true", help="estimate rates from positions, in front of the law")
parser.add_argument("--out", type=Path, help="the folder; left out, export/CONTROLLER")
options = parser.parse_args()
try:
    rig = dpend.rig(options.rig)
    controller = controller_named(options.controller, rig)
    if options.differences:
        controller = WithEstimator(Differences(rig), controller)
    stem = options.controller.rpartition(":")[2].replace(" ", "-").replace("/", "-")
    print(export(controller, rig, options.to, options.out or Path("export") / stem, real=options.real))
except (ImportError, OSError, ValueError) as error:
    parser.exit(2, f"{error}\n")
