"""A plugin of pytest: the tests, and what they start, on a system without fcntl, fork and signals.

`PYTHONPATH=tests python -m pytest -p make.bare_system` is as near to Windows as Linux comes.
"""

import importlib
import multiprocessing
import os
import sys
from pathlib import Path

FOLDER = str(Path(__file__).parent / "bare")

sys.path.insert(0, FOLDER)
sys.modules.pop("sitecustomize", None)
importlib.import_module("sitecustomize")
sys.path.remove(FOLDER)
os.environ["PYTHONPATH"] = os.pathsep.join([FOLDER, os.environ.get("PYTHONPATH", "")])
multiprocessing.set_start_method("spawn")
