"""The status of several actuators together."""

from audioflinger_hook.daemon.status_report import worst_exposure
from audioflinger_hook.service.status import ExposureFigures


def test_without_actuators_there_is_no_exposure():
    assert worst_exposure([]) is None


def test_each_reading_of_the_exposure_is_of_the_actuator_where_it_is_worst():
    hum = ExposureFigures(20.0, 0.5, 0.6, 1.54, True, False, 0.2, True, "limit", 1.0)
    knock = ExposureFigures(19.0, 2.0, 0.1, 21.5, True, True, 0.9, False, "action", 0.4)
    for order in ([hum, knock], [knock, hum]):
        worst = worst_exposure(order)
        assert worst == ExposureFigures(20.0, 2.0, 0.6, 21.5, True, True, 0.2, True, "action", 0.4)
