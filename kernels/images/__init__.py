"""Reads contacts off an image, rates images by figures of merit, and draws contacts.

This room takes pixels. The room knows nothing of grounds, nor of the method that made an
image.
"""

from tomojax.kernels.images._contacts import (
    Contacts as Contacts,
    largest_variance as largest_variance,
    no_contacts as no_contacts,
    read_contacts as read_contacts,
    strongest_first as strongest_first,
)
from tomojax.kernels.images._drawing import (
    points_as_contacts as points_as_contacts,
    points_image as points_image,
    Spots as Spots,
)
from tomojax.kernels.images._explained import (
    explained as explained,
    explained_by as explained_by,
    point_sources as point_sources,
)
from tomojax.kernels.images._merit import (
    greit_figures as greit_figures,
    GreitFigures as GreitFigures,
    half_area_radius as half_area_radius,
    half_width as half_width,
    image_error as image_error,
    image_place as image_place,
    pixel_places as pixel_places,
)
from tomojax.kernels.images._peaks import find_peaks as find_peaks
from tomojax.kernels.images._place import highest_place as highest_place
from tomojax.kernels.images._regions import read_regions as read_regions
