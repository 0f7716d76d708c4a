"""The program as a user meets it: exit codes, one line that says what is wrong, help that is fast."""

import io
import os
import platform
import re
import signal
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import pytest

from tg4mm.cli import main

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "100", "NO_COLOR": "1"}


def tg4mm(*arguments):
    """Call the program as its entry point does."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), patch.dict(os.environ, ENVIRONMENT):
        code = main([*map(str, arguments)])
    return SimpleNamespace(returncode=code, stdout=out.getvalue(), stderr=err.getvalue())


def refused(done):
    """The one line on stderr of a program that refused its input; asserts that it is that."""
    assert done.returncode == 2, (done.returncode, done.stdout, done.stderr)
    assert done.stdout == ""
    assert re.fullmatch(r"tg4mm: [^\n]+\n", done.stderr), done.stderr
    return done.stderr.strip()


@pytest.fixture
def empty_run(tmp_path):
    """A run folder whose training has made nothing yet."""
    from tg4mm.run import Run

    (tmp_path / "data").mkdir()
    return Run.create(tmp_path / "run", tmp_path / "data", "modal", {}).path


def test_the_log_is_shown_once_where_progress_is():
    """Also after a second command in the same process, and on a stderr that is another by then, as under a bar."""
    code = (
        "import io, logging, sys\nfrom tg4mm.cli import main\nmain(['--version'])\nmain(['--version'])\n"
        "log = logging.getLogger('tg4mm.deep')\nlog.info('compiling')\nlog.debug('no')\n"
        "old, sys.stderr = sys.stderr, io.StringIO()\nlog.info('again')\n"
        "assert sys.stderr.getvalue() == 'again\\n'\nsys.stderr = old\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=ENVIRONMENT)
    assert (done.returncode, done.stderr) == (0, "compiling\n"), done.stderr


@pytest.mark.parametrize(("module", "encoding"), [("tg4mm", "cp1252"), ("dataset_gen", "cp437")])
def test_help_can_be_printed_where_the_encoding_lacks_a_letter(module, encoding):
    """As in a pipe on Windows: α is not in code page 1252, … not in 437."""
    environment = ENVIRONMENT | {"PYTHONIOENCODING": encoding}
    done = subprocess.run([sys.executable, "-m", module, "--help"], capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert b"?" in done.stdout
    assert b"Hz" in done.stdout


def test_help_is_fast_and_imports_nothing_heavy():
    code = (
        "import sys\nfor name in ('torch', 'bpy', 'numpy', 'numba', 'PIL'): sys.modules[name] = None\n"
        "from tg4mm.cli import main\nmain(['train', '--help'])\n"
    )
    resource = pytest.importorskip("resource", reason="Windows has no such figures")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=ENVIRONMENT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 0, done.stderr
    assert "--preset" in done.stdout
    # Processor time, which a busy machine does not stretch.
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bake"], r'Unknown command "bake" \(see tg4mm --help\)'),
        (["train"], r"DATASET is missing \(see tg4mm train --help\)"),
        (["train", "x", "--out", "y", "--preset", "papers"], "preset is 'papers', expected modal or"),
        (["train", "x", "--out", "y", "--frames", "3"], "Unknown option: --frames"),
        (["render", "x", "--out", "y", "--alpha", "big"], '--alpha.*"big"'),
        (["render", "x", "--out", "y", "--alpha", "1", "--orbit", "0"], '"0" for --orbit'),
        (["export", "x", "--out", "y", "--format", "usdz"], '"usdz" for --format'),
    ],
)
def test_usage_errors_are_one_line(arguments, message):
    assert re.search(message, refused(tg4mm(*arguments)))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["look", "film.mp4", "--out", ""], "what follows --out is empty"),
        (["measure", "run", "--out="], "--out is empty"),
        (["report", ""], "an argument is empty"),
    ],
)
def test_an_empty_path_is_not_the_folder_one_is_in(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert capsys.readouterr().err == f"tg4mm: {said}\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        (["seed"], "--set 'seed' is not of the form key=value"),
        (["=3"], "--set '=3' is not of the form key=value"),
        (["seed=1", "seed=2"], "--set seed is given twice"),
    ],
)
def test_bad_settings_are_refused(tmp_path, pairs, message):
    options = [option for pair in pairs for option in ("--set", pair)]
    assert message in refused(tg4mm("train", tmp_path, "--out", tmp_path / "run", *options))


@pytest.mark.parametrize("command", ["render", "evaluate", "export"])
def test_folder_that_is_no_run_is_named(tmp_path, command):
    options = ["--alpha", "5"] if command == "render" else []
    done = tg4mm(command, tmp_path, "--out", tmp_path / "out", *options)
    assert f"{tmp_path} is not a run folder: it has no config.json" in refused(done)
    assert not (tmp_path / "out").exists()


def test_unfinished_run_is_refused(empty_run, tmp_path):
    done = tg4mm("export", empty_run, "--out", tmp_path / "a.ply")
    assert "its space stage is not finished" in refused(done)


def probing(body):
    """The words that run main() with a command of that body."""
    code = (
        "import sys; from tg4mm.cli import program\n"
        f"def probe() -> None:\n    {body}\n"
        "program.app.command(probe)\nsys.exit(program.main(['probe']))\n"
    )
    return [sys.executable, "-c", code]


def run_main(body):
    return subprocess.run(probing(body), capture_output=True, text=True, env=ENVIRONMENT)


def test_fault_of_the_program_keeps_its_traceback_and_exits_with_1():
    done = run_main("[][3]")
    assert done.returncode == 1
    assert "Traceback" in done.stderr
    assert "IndexError" in done.stderr


@pytest.mark.parametrize(
    ("error", "said"),
    [
        ("OSError(28, 'No space left', 'a.json')",
         "a.json: No space left; make room there and give the same command again"),
        ("OSError('No space left')", "No space left"),
        (r"Tg4mmError('size is a\nb\x1b[31m')", r"size is a b\x1b[31m"),
    ],
)  # fmt: skip
def test_fault_of_the_system_or_of_the_input_is_one_line(error, said):
    assert refused(run_main(f"from tg4mm.core.errors import Tg4mmError; raise {error}")) == f"tg4mm: {said}"


def test_reader_that_goes_away_ends_it_quietly():
    done = run_main("raise BrokenPipeError(32, 'Broken pipe')")
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "")


def test_missing_core_package_says_how_to_install_it():
    done = run_main("sys.modules['torch'] = None; import torch")
    assert refused(done) == 'tg4mm: this command needs torch: pip install "tg4mm[core]"'


@pytest.mark.parametrize(
    ("package", "words", "extras"),
    [("viser", "view a.mp4", "core,view"), ("scipy", "sfm a.mp4 --out b", "sfm")],
)
def test_all_that_a_command_needs_is_named_at_once(package, words, extras):
    code = f"import sys; sys.modules['{package}'] = None; from tg4mm.cli import main; sys.exit(main({words.split()}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=ENVIRONMENT)
    assert refused(done) == f'tg4mm: this command needs {package}: pip install "tg4mm[{extras}]"'


def test_interrupt_exits_with_130_and_says_how_to_go_on():
    command = probing("import time; print('ready', flush=True); time.sleep(60)")
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, env=ENVIRONMENT, **pipes) as child:
        assert child.stdout.readline() == "ready\n"
        child.send_signal(signal.SIGINT)
        _, err = child.communicate(timeout=20)
    assert child.returncode == 130
    assert "interrupted; run the same command again" in err
    assert "Traceback" not in err


def test_generate_without_blender_says_how_to_install_it():
    code = (
        "import sys, importlib.util as u; find = u.find_spec\n"
        "u.find_spec = lambda name: None if name == 'bpy' else find(name)\n"
        "from tg4mm.cli import main; sys.exit(main(['generate', 'mic', '--out', 'x']))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=ENVIRONMENT)
    assert 'bpy, which is not installed: pip install "tg4mm[generate]"' in refused(done)


@pytest.mark.parametrize("start", ["fill()", "t = threading.Thread(target=fill); t.start(); t.join()"])
@pytest.mark.skipif(sys.platform != "linux" or platform.libc_ver()[0] != "glibc", reason="of glibc alone")
def test_a_large_array_takes_the_place_of_the_last_one(repo_root, start):
    """An array of 32 MiB takes 8,192 pages, which the system hands out anew unless the program keeps them."""
    program = (
        "import resource, threading, numpy as np\n{}\n"
        "def faults(): return resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "def fill():\n"
        "    held = [np.ones(1 << 20) for _ in range(5)]\n"
        "    for _ in range(2): np.ones(4 << 20)\n"
        "    before = faults()\n"
        "    for _ in range(4): np.ones(4 << 20)\n"
        "    print(faults() - before)\n"
        f"{start}"
    )
    kept = "from tg4mm.cli.program import _keep_freed_memory; _keep_freed_memory()"
    counts = []
    for first in ("", kept):
        words = [sys.executable, "-c", program.format(first)]
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("MALLOC", "GLIBC"))}
        environment["NUMPY_MADVISE_HUGEPAGE"] = "0"
        done = subprocess.run(
            words, cwd=repo_root, capture_output=True, text=True, check=True, env=environment
        )
        counts.append(int(done.stdout))
    assert counts[1] < 0.1 * counts[0]
