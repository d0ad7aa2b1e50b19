"""The sheet as `check` sees it: slots of a recording, and one contact fitted to each.

These files know physics and what contacts leave of voltages. They know no fault.
"""
