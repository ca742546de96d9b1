"""All processes of these tests have one token, whatever the machine and its Ray are set to.

A process has the mode in which it first met Ray, and processes of different modes do not hear each
other: cluster, commands and this process must begin with the same one. To be imported before Ray.
"""

import os
import secrets
from importlib import util

if util.find_spec("ray") is not None:
    os.environ["RAY_AUTH_MODE"] = "token"
    os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
