"""Results files from outside, judged before anything is made of them.

The room opens and checks. It writes nothing, and knows nothing of methods but their rows.
"""

from tomojax.results.loading._labels import (
    DIMENSIONS as DIMENSIONS,
    flag_names as flag_names,
    IMAGES as IMAGES,
    label as label,
    parts_of as parts_of,
)
from tomojax.results.loading._load import (
    attributes as attributes,
    LoadedResults as LoadedResults,
    open_results as open_results,
    places as places,
    SCHEMA as SCHEMA,
    VERSION as VERSION,
)
