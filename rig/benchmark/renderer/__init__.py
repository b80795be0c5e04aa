"""A second renderer of gel pictures, for judging only: estimators on lifts that another simulator drew.

It shares no code and no number with the simulated bench, so that what both get wrong in the same way is
less. Its figures are simulated all the same.
"""
