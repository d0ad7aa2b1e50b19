"""Results files from outside, judged before anything is made of them.

The room opens and checks. It writes nothing, and knows nothing of methods but their rows.
"""

from tomojax.results.loading._load import (
    attributes as attributes,
    LoadedResults as LoadedResults,
    places as places,
    SCHEMA as SCHEMA,
    VERSION as VERSION,
)
