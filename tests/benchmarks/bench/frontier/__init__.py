"""Compares speed and accuracy of every method and its peers, on a rig of another model.

The study uses the library as any caller would.
"""

from bench.frontier._beside import (
    beside_peers as beside_peers,
    error_mm as error_mm,
    front as front,
    mark_front as mark_front,
)
from bench.frontier._measure import (
    grounds_of as grounds_of,
    Job as Job,
    repeated as repeated,
)
from bench.frontier._peer_operators import (
    paper_jacobian as paper_jacobian,
    peer_table as peer_table,
    peers_of as peers_of,
    pixel_places as pixel_places,
    read_half as read_half,
    read_peak as read_peak,
)
from bench.frontier._peers import (
    best_lambda as best_lambda,
    contact_of as contact_of,
    hindsight as hindsight,
    peer_contacts as peer_contacts,
    peer_images as peer_images,
    peer_rows as peer_rows,
)
from bench.frontier._rows import (
    method_rows as method_rows,
    rows_of_steps as rows_of_steps,
)
from bench.frontier._scenes import (
    DOUBT as DOUBT,
    FAR as FAR,
    ghost_error as ghost_error,
    identity as identity,
    KINDS as KINDS,
    load_trials as load_trials,
    make_trials as make_trials,
    place_error as place_error,
    save_trials as save_trials,
    score as score,
    Trials as Trials,
)
from bench.frontier._study import (
    jobs as jobs,
    measured as measured,
    run as run,
    same_run as same_run,
)
