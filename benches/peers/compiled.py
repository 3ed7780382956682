"""CasADi functions as machine code: written as C, compiled once, kept in a cache directory."""

import hashlib
import os
import subprocess
import tempfile
import time
from pathlib import Path

import casadi as ca

CACHE = Path(os.environ.get("SOFTARM_PEERS_CACHE", Path(tempfile.gettempdir()) / "softarm-peers"))
FLAGS = ["-O1", "-march=native", "-fPIC", "-shared"]


def compiled(function):
    """The same function, compiled; and the seconds that the compiler took (0 from the cache)."""
    name = function.name()
    generator = ca.CodeGenerator(name + ".c", {"verbose": False})
    generator.add(function)
    text = generator.dump()
    key = hashlib.sha256((text + " ".join(FLAGS)).encode()).hexdigest()[:16]
    library = CACHE / f"{name}-{key}.so"
    seconds = 0.0
    if not library.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        source = library.with_suffix(".c")
        source.write_text(text)
        start = time.perf_counter()
        partial = library.with_suffix(f".{os.getpid()}.so")
        subprocess.run(["gcc", *FLAGS, str(source), "-o", str(partial), "-lm"], check=True)
        partial.rename(library)
        seconds = time.perf_counter() - start
        source.unlink()
    return ca.external(name, str(library)), seconds
