"""Teams to train in: for learners that know nothing of merging."""
