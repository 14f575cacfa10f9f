"""Grasp selection: the selection environment, rules, learned selectors."""
