"""`shape`: the likeliest shape of the touching object, and how sure the shape is.

The model fits a frame, the description reads contacts off the fit, and the method keeps the
ladder's contract. The folder knows no other rung than `source`.
"""
