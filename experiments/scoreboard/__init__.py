"""What engines do as people run them, beside exact laws: cases, answers, the board, and what moved since another."""
