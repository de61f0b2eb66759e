"""Loaded before every test.

The folder of the command has the name of its package: imported here, the package is known before pytest meets
the tests in `athrl/tests` and takes the folder for it.
"""

import athrl  # noqa: F401
