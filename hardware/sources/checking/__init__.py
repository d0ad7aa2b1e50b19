"""A source on trial: what it promises, tried for a second and told in sentences.

The room reads from a source as the live loop does. It knows nothing of any rig.
"""

from tomojax.hardware.sources.checking._check import check_source as check_source
