"""Entry for Blender's own Python.

    blender --background --python dataset_gen/blender_main.py -- mic --out DIR …

Takes the arguments after `--`; the package need not be installed. With `--job FILE` it is one worker of a
run.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))


def run(arguments: list[str]) -> int:
    """The generator's command line, or one worker."""
    if arguments[:1] == ["--job"]:
        from dataset_gen.worker import work

        return work(Path(arguments[1]))
    from dataset_gen.__main__ import main

    return main(arguments)


if __name__ == "__main__":
    sys.exit(run(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []))
