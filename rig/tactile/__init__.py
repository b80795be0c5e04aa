"""From a tactile frame to the object's rotation.

`contact` finds the contact, `slip` is our estimator, `paper` holds the paper's methods, `peers` those
of others; `estimators` knows all of them by name. Imports the vocabulary of `drivers` alone.
"""
