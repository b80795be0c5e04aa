"""How a simulated DIGIT's gel looks when a surface dents it.

Imports `fakes.objects`.
"""
