#include "frames.h"

static void put_u16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
}

static void put_u32(uint8_t *at, uint32_t value)
{
    put_u16(at, (uint16_t)value);
    put_u16(at + 2, (uint16_t)(value >> 16));
}

static int16_t get_i16(const uint8_t *at)
{
    return (int16_t)(at[0] | at[1] << 8);
}

void c_encode_absolute_position(const struct absolute_position *command, uint8_t data[DATA_LENGTH])
{
    data[0] = 0xA4;
    data[1] = 0;
    put_u16(data + 2, command->max_speed_dps);
    put_u32(data + 4, (uint32_t)command->angle_centidegrees);
}

bool c_decode_feedback(const uint8_t data[DATA_LENGTH], struct feedback *feedback)
{
    if (data[0] != 0x9C) {
        return false;
    }
    feedback->temperature_celsius = (int8_t)data[1];
    feedback->current_centiamperes = get_i16(data + 2);
    feedback->speed_dps = get_i16(data + 4);
    feedback->angle_degrees = get_i16(data + 6);
    return true;
}

/* The nearest of the steps from 0 to `last` between `-max` and `max`. */
static bool symmetric_step(float value, float max, float last, uint32_t *step)
{
    if (!(value >= -max && value <= max)) { /* also refuses NaN */
        return false;
    }
    *step = (uint32_t)(value * (last / (2.0f * max)) + (last + 1.0f) / 2.0f);
    return true;
}

/* The nearest of the steps from 0 to 4095 between 0 and `max`. */
static bool gain_step(float value, float max, uint32_t *step)
{
    if (!(value >= 0.0f && value <= max)) {
        return false;
    }
    *step = (uint32_t)(value * (4095.0f / max) + 0.49999997f);
    return true;
}

bool c_encode_motion(const struct motion_set_point *set_point, uint8_t data[DATA_LENGTH])
{
    uint32_t p, v, kp, kd, t;
    if (!symmetric_step(set_point->position_rad, 12.5f, 65535.0f, &p) ||
        !symmetric_step(set_point->velocity_rad_s, 45.0f, 4095.0f, &v) ||
        !gain_step(set_point->kp, 500.0f, &kp) ||
        !gain_step(set_point->kd, 5.0f, &kd) ||
        !symmetric_step(set_point->torque_nm, 24.0f, 4095.0f, &t)) {
        return false;
    }
    data[0] = (uint8_t)(p >> 8);
    data[1] = (uint8_t)p;
    data[2] = (uint8_t)(v >> 4);
    data[3] = (uint8_t)(v << 4 | kp >> 8);
    data[4] = (uint8_t)kp;
    data[5] = (uint8_t)(kd >> 4);
    data[6] = (uint8_t)(kd << 4 | t >> 8);
    data[7] = (uint8_t)t;
    return true;
}

static float symmetric_value(uint32_t step, float max, float last)
{
    return (float)step * (2.0f * max) / last - max; /* in this order the last step is exactly `max` */
}

void c_decode_motion(const uint8_t data[DATA_LENGTH], struct motion_feedback *feedback)
{
    uint32_t p = (uint32_t)data[1] << 8 | data[2];
    uint32_t v = (uint32_t)data[3] << 4 | data[4] >> 4;
    uint32_t t = (uint32_t)(data[4] & 0x0F) << 8 | data[5];
    feedback->position_rad = symmetric_value(p, 12.5f, 65535.0f);
    feedback->velocity_rad_s = symmetric_value(v, 45.0f, 4095.0f);
    feedback->torque_nm = symmetric_value(t, 24.0f, 4095.0f);
}
