"""Opens results files from outside, and judges each before any use.

The folder opens and checks. The folder writes nothing and knows only the rows of methods.
"""

from tomojax.results.loading._dataset import apply as apply
from tomojax.results.loading._labels import (
    coordinates as coordinates,
    flag_names as flag_names,
    IMAGES as IMAGES,
    label as label,
    parts_of as parts_of,
    strength as strength,
    Variable as Variable,
    variables as variables,
)
from tomojax.results.loading._load import (
    LoadedResults as LoadedResults,
    open_results as open_results,
    SCHEMA as SCHEMA,
    VERSION as VERSION,
)
from tomojax.results.loading._making import attributes as attributes, places as places
