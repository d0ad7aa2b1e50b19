"""A page in the browser that shows the live loop or results, to this user alone.

A process beside the loop serves the page on this machine alone. The room draws what it is
told, and knows neither files nor methods.
"""

from tomojax.hardware.web._data import (
    chosen_electrode as chosen_electrode,
    contact_columns as contact_columns,
    ellipse_columns as ellipse_columns,
    flag_lines as flag_lines,
    marked_line as marked_line,
    numbers as numbers,
    pixels as pixels,
    spectrum as spectrum,
    volt_columns as volt_columns,
)
from tomojax.hardware.web._page import document as document, flag_rows as flag_rows
from tomojax.hardware.web._server import Pages as Pages, quiet as quiet, serve as serve
