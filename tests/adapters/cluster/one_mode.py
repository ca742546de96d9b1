"""Common Ray authentication mode of all processes of these tests.

The mode of a process is that of its first contact with Ray, and processes of different modes cannot
communicate. Cluster, commands and this process must therefore start with the same mode and token,
independent of the machine's settings. Import this module before Ray.
"""

import os
import secrets
from importlib import util

if util.find_spec("ray") is not None:
    os.environ["RAY_AUTH_MODE"] = "token"
    os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
