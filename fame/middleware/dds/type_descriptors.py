"""What Cyclone tells others of the types of `fame.middleware.builtin_types`, worked out beforehand.

Each end carries a description of its type (DDS XTypes 1.3, section 7.3.4: TypeInformation and TypeMapping). To compute
it, cyclonedds needs 30 ms for the first type, a fifth of the start of an engine; it is the same every time.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

from fame.middleware.builtin_types import PARTICIPANT, STRING


def describe(name: str, declared: Any) -> None:
    """Give a declared type its description, if it is one of those; cyclonedds computes that of others."""
    if name in _DESCRIPTIONS:
        length, packed = _DESCRIPTIONS[name]
        data = zlib.decompress(base64.b64decode(packed))
        declared.__idl__._xt_data = name, name  # only tells that they are there
        declared.__idl__._xt_bytedata = data[:length], data[length:]


_DESCRIPTIONS = {
    STRING: (
        100,
        "eNpLYGBgYBRgcNAA0ipALALEHyNTczm4dqotNl42V23ORgaQHAiwQGkmNPWfDt9quGbxUnr+Wq7ssphDDMFo6m1AdmAxF6T/YyAjWI4BahaI"
        "zQPlMzIUMPSW11ukQ8XR7fEHiQH1q0LVywJxcUlKfG5xerGVFZC0skpJKY63sgouKcrMS48HqZGGmiWMZAcrkE5JLEkE8ZWw24XmdACXeEJ8",
    ),
    PARTICIPANT: (
        196,
        "eNo7wMDAwCjA4BABpEOAWASIP15dtORafJXn5qrNz5OamBiigGJMQGwCpcFqOJul50/kyktbod34M+QHgxFMvKoqtqz8xJzuf55e8ifmM7SB"
        "9KCZ/0mv6SsP3+HE74tWP+7/ep5hKxbzPy27F5Zh1elvekzl9dSOpQzxMHHjyjcOG/O4LrvOOWxir8LAyMjA4AXEzFjcHQYSC2RkAEqDgRvU"
        "fEkonxHdF7rBK34DxeXAciDc8JERw0tTjZR90X3JwNCEZlcRELMAsQDcrkKwoZ6BPy0E4OZDxB65hCrKQd0GsxPVYRJp169D3MWMU03Otgmn"
        "0WOFgUEPzV0wv4nB3TXhMyNUTIC3t7zegoHBnQliD3o8bQSJAc2ygeoFxVdRbnl8SkpxfHJ+bm5+npVVbnG6lRVIwMoqILGoJDM5syAxr8Q1"
        "rySzJDO12DMvLT+eIRPqVyW4G9BjGxJ26ZkpYHlLRHx8YsRMAgziQLm8/JTU+FSoNfGZIHuKUwsxE8xfqB9MoXbr4veDH9BYVMcDwU6o+xTR"
        "4pYf5o68xNzU4oLE5FSIvAxafHMhqwOyDRFxD/YfemCAzC1KTUxJLYoHBgnUX1B9zAT0lRdllqDoQ1MVDQ0PDahfFPCHhzvQHAZ1qH/ksaYh"
        "BgZWIJ2SWJIIkotjwJqW0LIqWiShZS80J6MlcgA2lFF3",
    ),
}
"""Type -> length of the TypeInformation, and it with the TypeMapping, compressed."""
