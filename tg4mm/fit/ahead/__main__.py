"""`python -m tg4mm.fit.ahead`: compile every kernel for this processor now, not in the first command that needs it."""

from tg4mm.fit.ahead import compile_all

compile_all()
