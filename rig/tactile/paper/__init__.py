"""The paper's methods, corrected and as published: contact, long axis, window mean."""
