"""The scenes of `tomojax demo`: names, files, and the method that shows each."""

from typing import NamedTuple


class DemoScene(NamedTuple):
    """A recording that comes with the package.

    `words` say what touches; `file` lies in the package's folder; `method` finds it;
    `slow` is how many times slower than life the film runs.
    """

    words: str
    file: str
    method: str
    slow: float


SCENES = {
    "fingers": DemoScene("one finger draws an eight, another taps", "demo.h5", "auto", 4.0),
    "letters": DemoScene(
        "the letters T, A, C, T are pressed on, one by one", "demo_letters.h5", "shape", 8.0
    ),
    "spanner": DemoScene(
        "a spanner is dropped and rocks until it lies", "demo_spanner.h5", "shape", 100.0
    ),
    "palm": DemoScene(
        "fingertips touch, then the whole hand", "demo_palm.h5", "shape", 8.0
    ),
    "round": DemoScene(
        "a finger goes round a round skin, another presses its middle",
        "demo_round.h5",
        "auto",
        4.0,
    ),
    "glove": DemoScene(
        "a stick turns in a glove's palm with two holes", "demo_glove.h5", "shape", 8.0
    ),
}
