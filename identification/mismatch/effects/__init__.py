"""The library of effects: one file per physical effect, and the list of all of them."""
