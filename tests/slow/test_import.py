"""Importing any module leaves the process as it was."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import quatprop


def test_importing_changes_nothing_for_the_host():
    """No signal handler, no warning filter (but ruamel.yaml's own), no environment, no state."""
    code = """
import json, os, pkgutil, random, signal, sys, warnings
import importlib
import numpy, pyarrow
def state():
    handlers = {str(s): str(signal.getsignal(s)) for s in signal.valid_signals()}
    filters = [str(filter) for filter in warnings.filters if "ruamel" not in str(filter)]
    return [handlers, dict(os.environ), filters, str(random.getstate()), str(numpy.geterr()),
            os.getcwd(), sys.getrecursionlimit(), pyarrow.cpu_count()]
before = state()
import quatprop
for module in pkgutil.walk_packages(quatprop.__path__, "quatprop."):
    if not module.name.startswith(("quatprop.cli", "quatprop.__main__", "quatprop.tools.plot",
                                   "quatprop.pytest_plugin")):
        importlib.import_module(module.name)
print(json.dumps(before == state()))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) is True
    package = Path(quatprop.__file__).parent
    for path in package.rglob("*.py"):
        if path.relative_to(package).parts[0] not in {"cli", "__main__.py"}:
            for node in ast.walk(ast.parse(path.read_text())):
                name = getattr(node, "attr", "")
                assert name not in {"enable_signal_handlers", "set_cpu_count", "simplefilter"}, path
