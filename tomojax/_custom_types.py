"""Names the types of users' arguments."""

from collections.abc import Sequence
from typing import Any

from jax.typing import ArrayLike

# Numbers in any form; checked and converted once, at the boundary.
Numbers = ArrayLike | Sequence[Any]
