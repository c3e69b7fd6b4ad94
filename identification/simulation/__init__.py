"""Forward simulation of identified arms under a controller, and its comparison with recordings (the paper's Fig. 4)."""
