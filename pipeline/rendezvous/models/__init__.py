"""Networks and their losses: the paper's, DOPE's, the matcher."""
