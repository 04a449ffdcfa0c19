/* What one core can do at most: multiply-adds in vector registers, and bytes from memory. Build line: peak.py. */

#include <immintrin.h>
#include <stddef.h>

/* `rounds` times twelve independent multiply-adds of four doubles: 48 a round. */
double multiply_adds(long rounds) {
    __m256d a[12], x = _mm256_set1_pd(0.999999999), y = _mm256_set1_pd(1e-9);
    for (int k = 0; k < 12; k++) a[k] = _mm256_set1_pd(1.0 + k);
    for (long r = 0; r < rounds; r++)
        for (int k = 0; k < 12; k++) a[k] = _mm256_fmadd_pd(a[k], x, y);
    double sum = 0.0, out[4];
    for (int k = 0; k < 12; k++) {
        _mm256_storeu_pd(out, a[k]);
        sum += out[0] + out[1] + out[2] + out[3];
    }
    return sum;
}

/* Read and write n doubles once: 16 n bytes. */
void scale(double *values, size_t n) {
    for (size_t k = 0; k < n; k++) values[k] = values[k] * 1.0000001;
}
