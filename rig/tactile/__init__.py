"""From a tactile frame to the object's rotation: contact, axis, estimator."""
