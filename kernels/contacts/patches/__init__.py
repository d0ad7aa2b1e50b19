"""Models contacts by patches, whose currents the sheet decides.

The room knows the sheet as tables of potentials, and nothing of images.
"""

from tomojax.kernels.contacts.patches._patches import patches as patches
