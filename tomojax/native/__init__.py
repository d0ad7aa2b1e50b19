"""Writes JAX functions as C99: code alone, and the tables that it reads.

A function is traced, its operations are written one by one, and a compiler makes a library
of them: no JAX, no Python, no allocation and no lock in what runs. The room knows nothing
of sensors: it takes any function of arrays whose operations it has C for.
"""

from pathlib import Path

from tomojax.native._flow import function as function
from tomojax.native._library import (
    compile_c as compile_c,
    compiler as compiler,
    FLAGS as FLAGS,
    make_archive as make_archive,
    PLAIN as PLAIN,
)
from tomojax.native._places import c_type as c_type
from tomojax.native._program import program_of as program_of
from tomojax.native._tables import Tables as Tables

PRELUDE = (Path(__file__).parent / "prelude.h").read_text()

__all__ = [
    "c_type",
    "compile_c",
    "compiler",
    "FLAGS",
    "function",
    "make_archive",
    "PLAIN",
    "PRELUDE",
    "program_of",
    "Tables",
]
