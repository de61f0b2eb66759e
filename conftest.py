"""Loaded before every test.

The folder of the command has the name of its package: imported here, the package is known before pytest meets
the tests in `athrl/tests` and takes the folder for it.

pygame gets no screen. With one it loads the graphics driver, which brings an LLVM of its own that does not
get along with triton's: importing torch's compiler in the same process afterwards crashes. `putenv` tells SDL
alone; highway-env, which looks into `os.environ`, would stop drawing altogether.

MKL reads MKL_CBWR when it first computes. Serial runs set it in time in a process of their own; here some
other test may have computed before one, and its last bits would be those of sums in another order.
"""

import os

os.putenv("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("MKL_CBWR", "AUTO")

import athrl  # noqa: F401
