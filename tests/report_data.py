"""Independent decoder of the data in a page of ``rendezvous report``."""

import base64
import gzip
import json
import re

import numpy as np


def data_of(text):
    """Data of a page, and its recordings."""
    data = json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', text, re.DOTALL)[1])
    return data, re.findall(r'<script id="recording-\d+"[^>]*>(.*?)</script>', text)


def arrays_of(fields, text):
    """Arrays of a recording by name."""
    arrays, raw = {}, gzip.decompress(base64.b64decode(text))
    for name, kind, shape, *scale in fields:
        count, dtype = int(np.prod(shape)), np.dtype(kind).newbyteorder("<")
        part, raw = raw[: count * dtype.itemsize], raw[count * dtype.itemsize :]
        if not scale:
            arrays[name] = np.frombuffer(part, dtype).reshape(shape)
            continue
        low, high = np.frombuffer(part, np.uint8).reshape(2, count).astype(np.int64)
        sums = (low + 256 * high).reshape(*shape[1:], shape[0]).cumsum(axis=-1)
        whole = np.moveaxis((sums + 32768) % 65536 - 32768, -1, 0)
        arrays[name] = np.where(whole == -32768, np.nan, whole * scale[0])
    assert raw == b""
    return arrays
