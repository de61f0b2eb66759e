"""Towns, traffic, perception and control as gymnasium environments over highway-env."""
