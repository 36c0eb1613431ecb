"""Speed against error: ladders of settings, competitors, measurement, the front in words, the stored result."""
