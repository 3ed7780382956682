/* Does a loop in C do what one of softarm does? The tip of an arm follows the path of a scene; the plant is the simulated arm of the scene.
 *
 *     cargo build --release -p softarm-c
 *     cc crates/c/examples/loop.c -Icrates/c/include -Ltarget/release -lsoftarm_c -lm -o loop
 *     LD_LIBRARY_PATH=target/release ./loop mpc-track-circle 2.0
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "softarm.h"

static void check(int code, const char *where) {
    if (code < 0) {
        fprintf(stderr, "%s: code %d: %s\n", where, code, softarm_text());
        exit(1);
    }
}

/* The number after a key in a line of JSON. */
static double number(const char *line, const char *key) {
    const char *at = strstr(line, key);
    return at ? strtod(at + strlen(key), NULL) : NAN;
}

int main(int argc, char **argv) {
    const char *scene = argc > 1 ? argv[1] : "mpc-track-circle";
    const double duration = argc > 2 ? atof(argv[2]) : 2.0;
    softarm_controller *controller;
    softarm_plant *plant;
    softarm_description description;
    check(softarm_new(scene, NULL, 0, &controller), "new");
    check(softarm_describe(controller, &description), "describe");
    check(softarm_plant_new(controller, &plant), "plant");

    const size_t n = description.n_nodes;
    double *x = malloc(3 * n * sizeof *x), *r = malloc(9 * n * sizeof *r);
    double *v = malloc(3 * n * sizeof *v), *w = malloc(3 * n * sizeof *w);
    double *values = malloc(description.n_controls * sizeof *values);
    const int samples = (int)lround(duration / description.period_s);
    /* The tip at every sample: an estimate, and with it its reference, is older than the sample. */
    double (*tips)[3] = malloc((samples + 1) * sizeof *tips);
    if (!x || !r || !v || !w || !values || !tips) return 1;

    double sum = 0.0;
    int counted = 0, fallbacks = 0;
    for (int k = 0; k < samples; k++) {
        softarm_measurement measurement = {0};
        check(softarm_plant_state(plant, &measurement.time_s, x, r, v, w), "plant state");
        measurement.positions = x;
        measurement.rotations = r;
        measurement.velocities = v;
        measurement.angular_velocities = w;
        const char *answer;
        const int code = softarm_step(controller, &measurement, &answer);
        check(code, "step");
        fallbacks += code == SOFTARM_FALLBACK;
        /* A controller of the actuators asks as often as it likes, also from another thread. */
        check(softarm_acting(controller, measurement.time_s + 0.5 * description.period_s, values), "acting");
        check(softarm_plant_step(plant, controller, description.period_s), "plant step");

        memcpy(tips[k], x + 3 * (n - 1), sizeof tips[k]);
        const char *tip = strstr(answer, "\"tip\":{");
        const char *reference = tip ? strstr(tip, "\"reference_m\":[") : NULL;
        if (reference && 2 * k >= samples) {
            const int then = (int)lround(number(tip, "\"time_s\":") / description.period_s);
            reference += strlen("\"reference_m\":[");
            for (int axis = 0; axis < 3; axis++) {
                char *end;
                const double off = strtod(reference, &end) - tips[then][axis];
                sum += off * off;
                reference = end + 1;
            }
            counted++;
        }
    }
    printf("%d samples of %g s, %d fall-backs; controls:", samples, description.period_s, fallbacks);
    for (size_t i = 0; i < description.n_controls; i++) {
        printf(" %s = %.4g %s;", description.names[i], values[i], description.units[i]);
    }
    const double length = number(description.hello, "\"length_m\":");
    printf("\ntip error, second half, root mean square: %.6g of the length\n", counted ? sqrt(sum / counted) / length : NAN);
    softarm_plant_free(plant);
    softarm_free(controller);
    free(x);
    free(r);
    free(v);
    free(w);
    free(values);
    free(tips);
    return 0;
}
