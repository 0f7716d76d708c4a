"""The preferences' button Test: checks whether the Python of the Core can train."""

import json
import subprocess
from typing import Any

from dataset_gen.errors import GenerateError
from tg4mm.core import __version__ as own_version
from tg4mm.core.extras import install

from ..declare import Declared
from . import commands, generating

LIMIT_S = 60.0
NEEDED = ("tg4mm", "torch", "numba", "safetensors", "bpy")
_ASK = """
import importlib.util, json, sys
there = {name: importlib.util.find_spec(name) is not None for name in sys.argv[1:]}
version = None
if there["tg4mm"]:
    import tg4mm
    version = tg4mm.__version__
print(json.dumps({"python": sys.version.split()[0], "there": there, "version": version}))
"""
_ui = Declared()
register, unregister = _ui.register, _ui.unregister
_INSTALL = f"run this Python with -m {install('core', 'generate')}"


def check(python: str, own_version: str) -> str:
    """Return one line about a complete Python. Raises GenerateError naming what is missing and what to do."""
    command = (python, "-c", _ASK, *NEEDED)
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=LIMIT_S,
            env=commands.environment(),
            stdin=subprocess.DEVNULL,
        )
        said = json.loads(done.stdout.splitlines()[-1])
        there, version, number = dict(said["there"]), said["version"], str(said["python"])
    except subprocess.TimeoutExpired:
        raise GenerateError(f"{python} did not answer within {LIMIT_S:g} s") from None
    except OSError as error:
        raise GenerateError(f"{python} cannot be started: {error.strerror or error}") from None
    except (ValueError, IndexError, KeyError, TypeError):
        raise GenerateError(
            f"{python} is not a Python interpreter: choose bin/python of an environment"
        ) from None
    missing = [name for name in NEEDED if not there.get(name)]
    if missing:
        raise GenerateError(f"Python {number} of {python} has no {', '.join(missing)}; {_INSTALL}")
    other = (
        ""
        if version == own_version
        else f"; this extension is {own_version}: install the same version of both"
    )
    return f"tg4mm {version} on Python {number}, ready to generate and to train{other}"


@_ui.operator("Test", undo=False)
def test_core(operator: Any, context: Any) -> str:
    """Start the Python of the Core and check that everything needed to generate and train is installed"""
    python = generating.core_python(context)
    if not python:
        raise GenerateError("Python of the Core is empty: choose bin/python of an environment with tg4mm")
    return check(python, own_version)
