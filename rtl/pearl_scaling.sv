// SPDX-License-Identifier: MIT
// From the elements of a group's rows to inputs of a network: (element - offset) * multiplier >> shift, cut at a limit
// on both sides. PRODUCTS elements of each row a cycle, so that a group takes CHUNKS cycles.
module pearl_scaling
  import pearl_pkg::*;
#(
    parameter int unsigned ROWS = 4,
    parameter int unsigned ELEMENTS = 4,
    parameter int unsigned ELEMENT_BITS = 32,
    parameter int unsigned PRODUCTS = 4,
    parameter int unsigned VALUE_BITS = 12,
    parameter int unsigned INDEX_BITS = 12,
    localparam int unsigned CHUNKS = ceil_div(ELEMENTS, PRODUCTS)
) (
    input logic clk_i,
    input logic rst_ni,

    // An element has two numbers: its offset; its shift, above its multiplier. Elements of a word of them have indices
    // from a multiple of a power of two on.
    input logic [NumSections-1:0] we_i,
    input logic [ INDEX_BITS-1:0] index_i,
    input logic [           31:0] wdata_i,

    // A group, every CHUNKS cycles at most; whether it is the last one.
    input logic                                            valid_i,
    input logic                                            last_i,
    input logic [ROWS-1:0][ELEMENTS-1:0][ELEMENT_BITS-1:0] elements_i,

    output logic                                          valid_o,
    output logic                                          last_o,
    output logic [ROWS-1:0][PRODUCTS-1:0][VALUE_BITS-1:0] values_o
);

  // So many elements of a row at once: all, where it has less than PRODUCTS.
  localparam int unsigned COLUMNS = ELEMENTS < PRODUCTS ? ELEMENTS : PRODUCTS;
  localparam int unsigned CHUNK_BITS = index_bits(CHUNKS);
  localparam int unsigned COLUMN_BITS = $clog2(PRODUCTS);
  localparam int unsigned OFFSET_BITS = 32;
  localparam int unsigned SCALE_BITS = SHIFT_BITS + MULTIPLIER_BITS;
  localparam int unsigned DIFFERENCE_BITS = at_least(ELEMENT_BITS, OFFSET_BITS) + 1;
  localparam int unsigned SCALED_BITS = DIFFERENCE_BITS + MULTIPLIER_BITS + 1;
  // Its numbers are read, the difference, the product and a register behind it, the shift, the cut.
  localparam int unsigned STAGES = READ_LATENCY + 5;

  // Of some sections, and of the numbers as many bits as they have.
  logic unused_host;
  assign unused_host = ^{we_i, index_i, wdata_i};

  logic signed [VALUE_BITS-1:0] limit_q;
  always_ff @(posedge clk_i) begin
    if (we_i[Settings] && index_i == INDEX_BITS'(SETTING_INPUT)) limit_q <= wdata_i[VALUE_BITS-1:0];
  end

  // ---- A group, a word of its elements after the other ----

  logic [ROWS-1:0][CHUNKS*COLUMNS-1:0][ELEMENT_BITS-1:0] padded, elements_q;
  logic [CHUNK_BITS-1:0] chunk_q;
  logic active_q, group_last_q, chunk_last;
  logic [STAGES:1] valid_q, last_q;

  always_comb begin
    padded = '0;
    for (int unsigned row = 0; row < ROWS; row++) begin
      for (int unsigned i = 0; i < ELEMENTS; i++) padded[row][i] = elements_i[row][i];
    end
  end

  assign chunk_last = 32'(chunk_q) == CHUNKS - 1;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      active_q <= 1'b0;
      chunk_q  <= '0;
      valid_q  <= '0;
    end else begin
      if (active_q) chunk_q <= chunk_last ? '0 : chunk_q + 1'b1;
      if (valid_i) active_q <= 1'b1;
      else if (chunk_last) active_q <= 1'b0;
      valid_q <= {valid_q[STAGES-1:1], active_q};
    end
  end

  always_ff @(posedge clk_i) begin
    last_q <= {last_q[STAGES-1:1], group_last_q};
    if (valid_i) begin
      elements_q   <= padded;
      group_last_q <= last_i;
    end else begin
      for (int unsigned row = 0; row < ROWS; row++) begin
        elements_q[row] <= elements_q[row] >> (COLUMNS * ELEMENT_BITS);
      end
    end
  end

  assign valid_o = valid_q[STAGES];
  assign last_o  = last_q[STAGES];

  // ---- Each of them ----

  for (genvar i = 0; i < PRODUCTS; i++) begin : gen_column
    if (i >= COLUMNS) begin : gen_none
      for (genvar row = 0; row < ROWS; row++) begin : gen_row
        assign values_o[row][i] = '0;
      end
    end else begin : gen_scaled
      logic at_column;
      logic [CHUNK_BITS-1:0] write_chunk;
      logic signed [OFFSET_BITS-1:0] offset;
      logic [SHIFT_BITS-1:0] shift, shift_late;
      logic signed [MULTIPLIER_BITS:0] multiplier, multiplier_q;

      assign at_column   = 32'(index_i[INDEX_BITS-1:1]) % (1 << COLUMN_BITS) == i;
      assign write_chunk = CHUNK_BITS'(32'(index_i[INDEX_BITS-1:1]) >> COLUMN_BITS);

      pearl_ram #(
          .WIDTH(OFFSET_BITS),
          .DEPTH(CHUNKS)
      ) u_offsets (
          .clk_i,
          .we_i   (we_i[Scalings] && at_column && !index_i[0]),
          .waddr_i(write_chunk),
          .wdata_i(wdata_i),
          .re_i   (active_q),
          .raddr_i(chunk_q),
          .rdata_o(offset)
      );
      pearl_ram #(
          .WIDTH(SCALE_BITS),
          .DEPTH(CHUNKS)
      ) u_scales (
          .clk_i,
          .we_i   (we_i[Scalings] && at_column && index_i[0]),
          .waddr_i(write_chunk),
          .wdata_i(wdata_i[SCALE_BITS-1:0]),
          .re_i   (active_q),
          .raddr_i(chunk_q),
          .rdata_o({shift, multiplier[MULTIPLIER_BITS-1:0]})
      );
      assign multiplier[MULTIPLIER_BITS] = 1'b0;

      always_ff @(posedge clk_i) multiplier_q <= multiplier;
      // As long as the difference, the product and its register take.
      pearl_delay #(
          .WIDTH (SHIFT_BITS),
          .STAGES(3)
      ) u_shift (
          .clk_i,
          .d_i(shift),
          .d_o(shift_late)
      );

      for (genvar row = 0; row < ROWS; row++) begin : gen_row
        logic [ELEMENT_BITS-1:0] element;
        logic signed [DIFFERENCE_BITS-1:0] difference_q;
        logic signed [SCALED_BITS-1:0] product_q, late_q, scaled_q;
        logic signed [VALUE_BITS-1:0] value_q;

        pearl_delay #(
            .WIDTH (ELEMENT_BITS),
            .STAGES(READ_LATENCY)
        ) u_element (
            .clk_i,
            .d_i(elements_q[row][i]),
            .d_o(element)
        );

        always_ff @(posedge clk_i) begin
          difference_q <= DIFFERENCE_BITS'($signed(element)) - DIFFERENCE_BITS'(offset);
          product_q    <= SCALED_BITS'(difference_q) * SCALED_BITS'(multiplier_q);
          late_q       <= product_q;
          scaled_q     <= late_q >>> shift_late;
          if (scaled_q > SCALED_BITS'(limit_q)) value_q <= limit_q;
          else if (scaled_q < -SCALED_BITS'(limit_q)) value_q <= -limit_q;
          else value_q <= scaled_q[VALUE_BITS-1:0];
        end
        assign values_o[row][i] = value_q;
      end
    end
  end

endmodule
