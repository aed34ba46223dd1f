"""Limits of errors that are normally distributed, for the tests and searches of all packages."""

from __future__ import annotations

# Standard deviations within which normal errors are taken to be. Origin: definition, 99.7 % of them are.
NORMAL_LIMIT = 3.0
# Standard deviations beyond which an error is gross: a normal one exceeds them once in two million.
# Origin: convention, five sigma.
GROSS_LIMIT = 5.0
