/* The controller of softarm for programs in C and C++. docs/c.md explains it.
 *
 * All numbers are in SI units. Vectors are x, y, z; rotations take the frame of a node, whose third axis points along the arm, to space, and are given
 * row by row. An arm with K elements has n_nodes = K + 1 nodes, from base to tip.
 *
 * Every function returns a code. What went wrong says softarm_text() of the same thread. Only softarm_acting() may be called while another thread
 * is in a function with the same controller.
 */
#ifndef SOFTARM_H
#define SOFTARM_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Codes. Commands are there as well with a positive one, and the loop goes on. */
enum {
    SOFTARM_OK = 0,
    SOFTARM_REFUSED = 1,   /* a part of the measurement cannot be, and was not used */
    SOFTARM_FALLBACK = 2,  /* the command is that of the fall-back: no usable measurement, or no plan */
    SOFTARM_SCENE = -1,    /* the scene cannot be used */
    SOFTARM_MODEL = -2,    /* the arm breaks down */
    SOFTARM_ARGUMENT = -3, /* an argument of the call is wrong */
    SOFTARM_FAULT = -4     /* a fault of softarm */
};

typedef struct softarm_controller softarm_controller;
typedef struct softarm_plant softarm_plant;

/* What a controller is. The pointers are valid as long as it is. */
typedef struct {
    double period_s;            /* time between two samples */
    double first_command_from_s; /* when the command of the first sample begins to act */
    size_t n_nodes;
    size_t n_controls;
    const double *places;        /* of the nodes, from 0 at the base to 1 */
    const char *const *names;    /* of the controls: actuators, and components such as "tip force x" */
    const char *const *units;    /* of the controls */
    const char *hello;           /* everything else as JSON, see docs/serving.md */
} softarm_description;

/* A measurement. A pointer is NULL where nothing was measured. */
typedef struct {
    double time_s;                    /* NAN: that of the next sample */
    const double *positions;          /* 3 for every node, m */
    const double *rotations;          /* 9 for every node */
    const double *velocities;         /* 3 for every node, m/s, spatial */
    const double *angular_velocities; /* 3 for every node, rad/s, in the frame of the node */
    const char *more;                 /* other fields of a measurement as a JSON object, such as readings and reference_m */
} softarm_measurement;

/* Makes the controller of a scene: a file, or the name of a built-in scene, with overrides "KEY=VALUE". */
int softarm_new(const char *scene, const char *const *overrides, size_t n_overrides, softarm_controller **controller);

/* Describes a controller. */
int softarm_describe(const softarm_controller *controller, softarm_description *description);

/* Answers a measurement, and prepares the next sample. `answer`, if it is not NULL, gets the lines of docs/serving.md, refusals first; they are valid
 * until the next call. */
int softarm_step(softarm_controller *controller, const softarm_measurement *measurement, const char **answer);

/* Writes the values of all controls that act at a time: whole efforts, as a tension with its pretension. Before the first command they are at rest, and
 * after its end a command holds. */
int softarm_acting(const softarm_controller *controller, double time_s, double *values);

/* Writes the state of the last knowledge, as it was measured or estimated, and its time. Arrays as in a measurement; NULL is left out. */
int softarm_state(const softarm_controller *controller, double *time_s, double *positions, double *rotations, double *velocities,
                  double *angular_velocities);

void softarm_free(softarm_controller *controller);

/* A simulated arm: the [plant] of the scene of a controller, which executes commands exactly. */
int softarm_plant_new(const softarm_controller *controller, softarm_plant **plant);

/* Moves the arm by a time in s under what acts by the controller at its beginning and at its end, linear in between. */
int softarm_plant_step(softarm_plant *plant, const softarm_controller *controller, double dt_s);

/* Writes the time, and the state on the nodes of the controller's model. */
int softarm_plant_state(const softarm_plant *plant, double *time_s, double *positions, double *rotations, double *velocities,
                        double *angular_velocities);

void softarm_plant_free(softarm_plant *plant);

/* The text of the last call of this thread that returned another code than SOFTARM_OK; valid until the next call. */
const char *softarm_text(void);

#ifdef __cplusplus
}
#endif

#endif
