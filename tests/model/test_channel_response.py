"""The record of channel gains and delays."""

import numpy as np

from clradar import ChannelResponse


def test_response_is_the_gain_times_the_phase_of_the_delay():
    gain = np.array([2.0 + 1.0j, 0.0])
    response = ChannelResponse(gain, [1.0], [20e-12, 0.0], [0.0], 77e9)
    found = response.tx_response(np.array([77e9, 77e9 + 12.5e9]))
    # A quarter turn back after 1 / (4 * 20 ps) = 12.5 GHz.
    np.testing.assert_allclose(found, [[2 + 1j, (2 + 1j) * -1j], [0, 0]], atol=1e-12)
    np.testing.assert_array_equal(response.rx_response(np.array([72e9, 82e9])), [[1, 1]])
