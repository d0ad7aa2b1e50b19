"""Opens results files from outside, and judges each before any use.

The folder opens and checks. The folder writes nothing and knows only the rows of methods.
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
