"""Scanner model: pulses, echoes, received power, amplitudes."""
