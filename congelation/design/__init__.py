"""What searches: the theta(t) that does most harm to a loop, and the gains that suit a wish."""
