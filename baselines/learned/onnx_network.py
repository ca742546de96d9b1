"""Networks exported by ``rendezvous export`` to ONNX, run by onnxruntime."""

import hashlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .checkpoints import CheckpointError, PathLike, as_path, refusing
from .numpy_actor import Array, Network
from .policy_settings import PolicySettings

SUFFIX = ".onnx"
SETTINGS_KEY = "rendezvous_policy"
"""Key in the model's metadata of the policy's settings, as JSON."""
DIGEST_KEY = "sha256"
"""Key in the model's metadata of the file's digest, as JSON, see ``digest_of``."""
NO_DIGEST = "0" * 64
_DIGEST = re.compile(rb'sha256\x12\x42"([0-9a-f]{64})"')
"""Key and value in protocol buffer encoding, found without parsing."""


def digest_of(content: bytes) -> str:
    """SHA-256 of a file, with its own digest replaced by NO_DIGEST."""
    blank = _DIGEST.sub(lambda found: found[0].replace(found[1], NO_DIGEST.encode()), content)
    return hashlib.sha256(blank).hexdigest()


def checked_session(path: Path, content: bytes) -> Any:
    """Session of a file with a valid digest; a CheckpointError for any other file."""
    digest = _DIGEST.search(content)  # before the content is parsed
    if digest is None:
        raise CheckpointError(
            f"{path}: has no digest: it was changed, or not written by `rendezvous export` of "
            "this version"
        )
    if digest[1].decode() != digest_of(content):
        raise CheckpointError(f"{path}: its content was changed: its digest does not match")
    return _session(path, content)


class OnnxNetwork(Network):
    """Network from a file of ``rendezvous export``, run by onnxruntime.

    It supports any ``layout`` with its columns. A CheckpointError names a file that cannot be read,
    was modified, has no digest or belongs to another version.
    """

    def __init__(self, path: PathLike) -> None:
        path = as_path(path)
        with refusing(path):
            content = path.read_bytes()
        self._session = checked_session(path, content)
        self._file = path, content
        found = self._session.get_modelmeta().custom_metadata_map.get(SETTINGS_KEY)
        if found is None:
            raise CheckpointError(
                f"{path}: its metadata has no {SETTINGS_KEY!r}; `rendezvous export` writes it"
            )
        with refusing(path, "is not a policy of this version"):
            self.settings = PolicySettings.from_plain(json.loads(found))
        self.layout = self.settings.layout(0, 0)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_session": None}  # the session cannot be pickled and is recreated

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _session=_session(*state["_file"]))

    def preferences(self, shown: Array, hidden: Array | None = None) -> Array:
        """As ``Network.preferences``."""
        given: dict[str, Any] = self.layout.split(shown)._asdict()
        if not self.settings.units:
            return self._run(["preferences"], given)[0]
        if hidden is None:
            hidden = np.zeros((len(shown), self.settings.units), dtype=np.float32)
        names = ["preferences", "hidden_next"]
        preferences, hidden[...] = self._run(names, given | {"hidden": hidden})
        return preferences

    def _run(self, names: list[str], given: dict[str, Any]) -> list[NDArray[Any]]:
        rows = {name: np.ascontiguousarray(array) for name, array in given.items()}
        found: list[NDArray[Any]] = self._session.run(names, rows)
        return found


def _session(path: Path, content: bytes) -> Any:
    """Session of onnxruntime on one thread, which is fastest for small networks."""
    try:
        import onnxruntime
    except ImportError as error:
        raise CheckpointError(
            f"{path}: needs onnxruntime: pip install 'rendezvous-env[export]'"
        ) from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    with refusing(path, "is not an ONNX model", (Exception,)):  # no narrower common base
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
