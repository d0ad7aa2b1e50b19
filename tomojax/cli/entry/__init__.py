"""Helpers of all commands: paths that are checked first, and Ctrl-C that is heard.

Before a command works, each file that the command will write is compared with all other
files that the command reads or writes. The room knows no command.
"""

from tomojax.cli.entry._amounts import (
    AMOUNT as AMOUNT,
    COUNT as COUNT,
    NUMBER as NUMBER,
    Pair as Pair,
    whole_number as whole_number,
)
from tomojax.cli.entry._command import Command as Command, stopped as stopped
from tomojax.cli.entry._interrupts import (
    interrupts as interrupts,
    listening as listening,
    STOPPED as STOPPED,
)
from tomojax.cli.entry._left import (
    json_option as json_option,
    out_option as out_option,
    picture_option as picture_option,
    save_picture as save_picture,
    write_report as write_report,
)
from tomojax.cli.entry._names import (
    check_name as check_name,
    FIXED as FIXED,
    ground_numbers as ground_numbers,
    METHODS as METHODS,
    POLICIES as POLICIES,
    sheet_of as sheet_of,
    SIZE as SIZE,
)
from tomojax.cli.entry._options import (
    calibration_option as calibration_option,
    grouped as grouped,
    like_option as like_option,
    since_option as since_option,
    stretch_options as stretch_options,
    wire_options as wire_options,
)
from tomojax.cli.entry._paths import (
    check_paths as check_paths,
    InputFile as InputFile,
    OutputFile as OutputFile,
    OutputFolder as OutputFolder,
    Written as Written,
)
from tomojax.cli.entry._progress import Progress as Progress
