"""Opens results files from outside, and judges each before any use.

The folder opens and checks. The folder writes nothing and knows only the rows of methods.
"""

from tomojax.results.loading._load import (
    attributes as attributes,
    LoadedResults as LoadedResults,
    places as places,
    SCHEMA as SCHEMA,
    VERSION as VERSION,
)
