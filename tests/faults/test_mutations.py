"""Every reader takes 150 mutations of its files ($TG4MM_MUTATIONS: another number) without a fault."""

import os

import pytest

from tests.faults.harness import run_reader
from tests.faults.readers import READERS

COUNT = int(os.environ.get("TG4MM_MUTATIONS", "150"))


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_mutated_files_are_refused_in_one_line_or_read(name):
    tally = run_reader(name, COUNT, seed=0)
    assert tally.count == COUNT
    assert not tally.faults, "\n".join(f"{index}: {what}" for index, what in tally.faults[:10])
