"""What the live form finds in single windows."""

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.principal import Principals, Spectrum
from tests.oracle.analysis import all_principal


def principal_in(
    windows: FloatArray, samplerate: int, parameters: TransformParameters | None = None
) -> Principals:
    """Return everything principal in band-passed windows (rows, N), not cut to n."""
    design = LiveDesign.of(parameters or TransformParameters(), samplerate).analysis
    spectra = Spectrum(samplerate, design.window, design.fft_length).transform(windows)
    return all_principal(design, spectra[:, : design.bins])
