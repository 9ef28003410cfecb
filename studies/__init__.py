"""Questions about controllers and learners, one file each; ``python -m studies`` lists them."""
