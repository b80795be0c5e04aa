"""Programs for whoever works on the fakes: `python -m fakes.tools.NAME`. May import all of them."""
