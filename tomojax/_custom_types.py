"""Names for what users may pass."""

from collections.abc import Sequence
from typing import Any

from jax.typing import ArrayLike

# Numbers in any form; checked and converted once, at the boundary.
Numbers = ArrayLike | Sequence[Any]
