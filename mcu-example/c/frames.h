/* The reference for the codecs of protocol-core: the same work in plain C, with the same range checks. It is for
 * measuring only: compiled with arm-none-eabi-gcc -O2 and linked into the firmware that counts instructions. */
#ifndef FRAMES_H
#define FRAMES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { DATA_LENGTH = 8, LINE_LENGTH = 13 };

/* 0xA4: go to a multi-turn angle (2.21). */
struct absolute_position {
    uint16_t max_speed_dps;
    int32_t angle_centidegrees;
};

/* The reply to 0x9C and to most set-points (2.15). */
struct feedback {
    int8_t temperature_celsius;
    int16_t current_centiamperes;
    int16_t speed_dps;
    int16_t angle_degrees;
};

void c_encode_absolute_position(const struct absolute_position *command, uint8_t data[DATA_LENGTH]);

/* False if the data are not the reply to 0x9C. */
bool c_decode_feedback(const uint8_t data[DATA_LENGTH], struct feedback *feedback);

/* Motion mode in SI units (5.1), on the scales of V4.3. */
struct motion_set_point {
    float position_rad;
    float velocity_rad_s;
    float kp;
    float kd;
    float torque_nm;
};

struct motion_feedback {
    float position_rad;
    float velocity_rad_s;
    float torque_nm;
};

/* False, and nothing is written, if a value is beyond its scale or NaN. */
bool c_encode_motion(const struct motion_set_point *set_point, uint8_t data[DATA_LENGTH]);

void c_decode_motion(const uint8_t data[DATA_LENGTH], struct motion_feedback *feedback);

void c_encode_line(uint8_t id, const uint8_t data[DATA_LENGTH], uint8_t line[LINE_LENGTH]);

/* Collects a frame byte by byte. It starts at 3E. If the bytes turn out to be no frame, it does not search them for
 * another start. */
struct receiver {
    uint8_t line[LINE_LENGTH];
    uint8_t length;
    uint16_t crc;
};

enum fed { FED_NOTHING, FED_FRAME, FED_BROKEN };

enum fed c_feed(struct receiver *receiver, uint8_t byte);

/* The baseline for `c_feed`: takes the byte and asks for more. */
enum fed c_want(struct receiver *receiver, uint8_t byte);

/* The baseline for all other functions: a call and a return. */
void c_nothing(const void *input, void *output);

#endif
