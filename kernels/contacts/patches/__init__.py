"""Models contacts by patches, whose currents the sheet decides."""

from tomojax.kernels.contacts.patches._patches import patches as patches
