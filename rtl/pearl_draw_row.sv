// SPDX-License-Identifier: MIT
// All random draws of a group: DRAWS for each of PE_NUM neighbouring slots.
module pearl_draw_row #(
    parameter int unsigned PE_NUM = 4,
    parameter int unsigned DRAWS  = 1
) (
    input  logic                               clk_i,
    // The global number of the group's first slot.
    input  logic [      31:0]                  slot_i,
    input  logic [ DRAWS-1:0][     31:0]       key_a_i,
    input  logic [ DRAWS-1:0][     31:0]       key_b_i,
    output logic [PE_NUM-1:0][DRAWS-1:0][31:0] draws_o
);

  for (genvar pe = 0; pe < PE_NUM; pe++) begin : gen_pe
    for (genvar i = 0; i < DRAWS; i++) begin : gen_draw
      pearl_draw u_draw (
          .clk_i,
          .slot_i (slot_i + 32'(pe)),
          .key_a_i(key_a_i[i]),
          .key_b_i(key_b_i[i]),
          .draw_o (draws_o[pe][i])
      );
    end
  end

endmodule
