"""The kinds of checks: each measures a figure and knows neither a statement nor its recorded verdict."""
