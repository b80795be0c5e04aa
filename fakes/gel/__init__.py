"""How a simulated DIGIT's gel looks when a surface dents it: the pad, its light, markers, the sensor.

Imports `fakes.objects`; it knows neither the world nor a device.
"""
