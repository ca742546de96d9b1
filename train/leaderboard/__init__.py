"""Algorithms × fields × seeds: who meets, who touches, what a guarantee costs."""
